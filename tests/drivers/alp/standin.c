/* A stand-in for ViALUX's ALP library: the functions that the driver calls, with the binary interface of alp.h
   (32-bit numbers, a packed structure of 18 bytes), over a device that keeps pictures and time. Not the maker's code;
   signatures and codes by alp4lib 1.1. The functions called Standin... are for the test. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { HEIGHT = 48, WIDTH = 64, MEMORY = 40, SEQUENCES = 8 };
enum { OK = 0, NOT_ONLINE = 1001, NOT_AVAILABLE = 1003, NOT_READY = 1004, INVALID = 1005, FULL = 1007, IN_USE = 1008,
       REMOVED = 1012 };

struct sequence {
  int used, count, asked, uninterrupted, repeats;
  int32_t illuminate, picture, delay, pulse;
  uint8_t *data;
};
#pragma pack(push, 1)
struct gate { uint8_t period, polarity, entries[16]; };
#pragma pack(pop)

static struct sequence sequences[SEQUENCES];
static struct gate gate_1;
static int allocated, plugged = 1, running = -1, endless, refusal, temperature = -384;
static double until;

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}
static int busy(void) {
  if (running >= 0 && !endless && now() >= until) running = -1;
  return running >= 0;
}
static int stored(void) {
  int sum = 0;
  for (int i = 0; i < SEQUENCES; i++) sum += sequences[i].used ? sequences[i].count : 0;
  return sum;
}
static int32_t checked(uint32_t device) {
  if (!plugged) return REMOVED;
  if (refusal) { int code = refusal; refusal = 0; return code; }
  return allocated && device == 77 ? OK : NOT_AVAILABLE;
}
static struct sequence *of(int32_t id) {
  return id >= 1 && id <= SEQUENCES && sequences[id - 1].used ? &sequences[id - 1] : NULL;
}

int32_t AlpDevAlloc(int32_t number, int32_t flag, uint32_t *device) {
  if (!plugged || (number && number != 4711)) return NOT_ONLINE;
  if (flag) return INVALID;
  if (allocated) return NOT_READY;
  allocated = 1; running = -1;
  *device = 77;
  return OK;
}
int32_t AlpDevInquire(uint32_t device, int32_t kind, int32_t *value) {
  int32_t code = checked(device);
  if (code) return code;
  switch (kind) {
    case 2000: *value = 4711; break;
    case 2001: *value = 0x43; break;
    case 2002: *value = busy() ? 1100 : 1102; break;
    case 2003: *value = MEMORY - stored(); break;
    case 2050: case 2051: *value = temperature; break;
    case 2021: *value = 4; break;
    case 2057: *value = HEIGHT; break;
    case 2058: *value = WIDTH; break;
    case 2064: *value = 0; break;
    default: return INVALID;
  }
  return OK;
}
int32_t AlpDevControlEx(uint32_t device, int32_t kind, void *structure) {
  int32_t code = checked(device);
  if (code) return code;
  if (kind != 2023) return INVALID;
  memcpy(&gate_1, structure, sizeof gate_1);
  return gate_1.period <= 16 && gate_1.polarity <= 1 ? OK : INVALID;
}
int32_t AlpDevHalt(uint32_t device) {
  int32_t code = checked(device);
  if (!code) running = -1;
  return code;
}
int32_t AlpDevFree(uint32_t device) {
  int32_t code = checked(device);
  if (code) return code;
  if (busy()) return 1002;
  for (int i = 0; i < SEQUENCES; i++) { free(sequences[i].data); memset(&sequences[i], 0, sizeof sequences[i]); }
  allocated = 0;
  return OK;
}
int32_t AlpSeqAlloc(uint32_t device, int32_t bits, int32_t count, uint32_t *id) {
  int32_t code = checked(device);
  if (code) return code;
  if (bits != 1 || count < 1) return INVALID;
  if (stored() + count > MEMORY) return FULL;
  for (int i = 0; i < SEQUENCES; i++)
    if (!sequences[i].used) {
      struct sequence made = {1, count, 0, 0, 1, 0, 33334, 0, 0, calloc(count, HEIGHT * WIDTH)};
      sequences[i] = made;
      *id = i + 1;
      return OK;
    }
  return FULL;
}
int32_t AlpSeqFree(uint32_t device, int32_t id) {
  int32_t code = checked(device);
  if (code) return code;
  if (!of(id)) return NOT_AVAILABLE;
  if (busy() && running == id) return IN_USE;
  free(of(id)->data);
  memset(of(id), 0, sizeof(struct sequence));
  return OK;
}
int32_t AlpSeqControl(uint32_t device, int32_t id, int32_t kind, int32_t value) {
  int32_t code = checked(device);
  if (code) return code;
  if (!of(id)) return NOT_AVAILABLE;
  if (kind == 2104) of(id)->asked = value == 2106;
  else if (kind == 2100 && value > 0) of(id)->repeats = value;
  else if (kind != 2110 || value) return INVALID;
  return OK;
}
int32_t AlpSeqInquire(uint32_t device, int32_t id, int32_t kind, int32_t *value) {
  int32_t code = checked(device);
  if (code) return code;
  if (!of(id)) return NOT_AVAILABLE;
  switch (kind) {
    case 2211: *value = of(id)->uninterrupted ? 44 : 88; break;
    case 2212: *value = 44; break;
    case 2213: *value = 10000000; break;
    default: return INVALID;
  }
  return OK;
}
int32_t AlpSeqTiming(uint32_t device, int32_t id, int32_t illuminate, int32_t picture, int32_t delay, int32_t pulse,
                     int32_t trigger_delay) {
  int32_t code = checked(device);
  if (code) return code;
  struct sequence *s = of(id);
  if (!s) return NOT_AVAILABLE;
  s->uninterrupted = s->asked; /* active with the times, as in the maker's sample */
  if (!picture) picture = 33334;
  if (picture < (s->uninterrupted ? 44 : 88) || illuminate > picture - (s->uninterrupted ? 0 : 44) || trigger_delay)
    return INVALID;
  s->illuminate = illuminate; s->picture = picture; s->delay = delay; s->pulse = pulse;
  return OK;
}
int32_t AlpSeqPut(uint32_t device, int32_t id, int32_t offset, int32_t load, const void *data) {
  int32_t code = checked(device);
  if (code) return code;
  struct sequence *s = of(id);
  if (!s) return NOT_AVAILABLE;
  if (offset < 0 || load < 1 || offset + load > s->count) return INVALID;
  for (int i = 0; i < load * HEIGHT * WIDTH; i++)
    s->data[offset * HEIGHT * WIDTH + i] = (((const uint8_t *)data)[i] & 0x80) != 0;
  return OK;
}
int32_t AlpProjControl(uint32_t device, int32_t kind, int32_t value) {
  int32_t code = checked(device);
  return code ? code : kind == 2306 && value >= 0 ? OK : INVALID;
}
static int32_t start(uint32_t device, int32_t id, int without_end) {
  int32_t code = checked(device);
  if (code) return code;
  if (!of(id)) return NOT_AVAILABLE;
  running = id; endless = without_end;
  until = now() + 1e-6 * of(id)->picture * of(id)->count * of(id)->repeats;
  return OK;
}
int32_t AlpProjStart(uint32_t device, int32_t id) { return start(device, id, 0); }
int32_t AlpProjStartCont(uint32_t device, int32_t id) { return start(device, id, 1); }

void StandinPlug(int32_t in) { plugged = in; if (!in) { allocated = 0; running = -1; } }
void StandinRefuse(int32_t code) { refusal = code; }
int32_t StandinMirror(int32_t id, int32_t picture, int32_t row, int32_t column) {
  return of(id) ? of(id)->data[(picture * HEIGHT + row) * WIDTH + column] : -1;
}
int32_t StandinTime(int32_t id, int32_t which) {
  struct sequence *s = of(id);
  int32_t times[] = {s->illuminate, s->picture, s->delay, s->pulse, s->repeats, s->uninterrupted};
  return times[which];
}
int32_t StandinGate(int32_t byte) { return ((uint8_t *)&gate_1)[byte]; }
