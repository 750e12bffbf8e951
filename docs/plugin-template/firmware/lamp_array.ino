// 12 x 16 lamps on twelve pairs of 74HC595 shift registers, a shutter and a trigger output, for gs2ci.
// Not yet run on a board. Lines of text at 115200 baud; one reply each:
//   ?                                         lamp-array 1 SERIAL
//   L COUNT EXPOSURE DARK PAUSE REPEATS OUT   ok   us; OUT: NONE EXPOSURE GATE MASK
//   M INDEX HEX48                             ok   12 rows of 16 bits, leftmost lamp highest
//   A   armed, shutter opens      G   run      S   stop, dark, shutter closed      Q   STATE SHOWN
// Anything else, or at another time: no REASON.
#include <SPI.h>

const byte LATCH = 10, SHUTTER = 5, TRIGGER = 6;
const byte ROWS = 12, MOST = 32;
const unsigned PULSE_US = 50;

byte masks[MOST][ROWS * 2];
unsigned long filled = 0;  // a bit for each mask
byte count = 0;
unsigned long exposureUs, darkUs, pauseUs, repeats;
char out = 'N';
bool armed = false, running = false, lit = false;
unsigned long shown = 0, slotsDone = 0, nextUs = 0, pulseEndUs = 0;
bool pulsing = false;
char line[128];
byte length = 0;

void show(const byte *mask) {
  digitalWrite(LATCH, LOW);
  for (byte i = 0; i < ROWS * 2; i++) SPI.transfer(mask ? mask[i] : 0);
  digitalWrite(LATCH, HIGH);
}

void stopAll() {
  running = armed = lit = pulsing = false;
  show(0);
  digitalWrite(TRIGGER, LOW);
  digitalWrite(SHUTTER, LOW);
  shown = 0;
}

bool loaded() { return count && filled == (count == 32 ? 0xFFFFFFFFUL : (1UL << count) - 1); }

void setup() {
  Serial.begin(115200);
  SPI.begin();
  pinMode(LATCH, OUTPUT);
  pinMode(SHUTTER, OUTPUT);
  pinMode(TRIGGER, OUTPUT);
  stopAll();
}

void step() {
  unsigned long now = micros();
  if (pulsing && (long)(now - pulseEndUs) >= 0) { digitalWrite(TRIGGER, LOW); pulsing = false; }
  if (!running || (long)(now - nextUs) < 0) return;
  byte slot = slotsDone % count;
  if (!lit) {  // a mask begins
    show(masks[slot]);
    lit = true;
    shown++;
    if (out == 'M' || (out == 'E' && slot == 0)) { digitalWrite(TRIGGER, HIGH); pulsing = true; pulseEndUs = nextUs + PULSE_US; }
    if (out == 'G' && slot == 0) digitalWrite(TRIGGER, HIGH);
    nextUs += exposureUs;
    return;
  }
  slotsDone++;  // it ends
  bool endsPass = slotsDone % count == 0, last = repeats && slotsDone >= repeats * count;
  unsigned long wait = endsPass ? pauseUs : darkUs;
  if (wait || last) show(0);
  if (endsPass && out == 'G') digitalWrite(TRIGGER, LOW);
  lit = false;
  nextUs += wait;
  if (last) running = false;
}

void answer() {
  char *word = strtok(line, " ");
  if (!word) { Serial.println("no line"); return; }
  if (!strcmp(word, "?")) { Serial.println("lamp-array 1 0001"); return; }
  if (!strcmp(word, "S")) { stopAll(); Serial.println("ok"); return; }
  if (!strcmp(word, "Q")) {
    Serial.print(running ? "running " : armed ? "armed " : loaded() ? "loaded " : "idle ");
    Serial.println(shown);
    return;
  }
  if (!strcmp(word, "L")) {
    unsigned long told[5];
    for (byte i = 0; i < 5; i++) { char *part = strtok(0, " "); if (!part) { Serial.println("no number"); return; } told[i] = strtoul(part, 0, 10); }
    char *mode = strtok(0, " ");
    if (!mode || told[0] < 1 || told[0] > MOST) { Serial.println("no room"); return; }
    count = told[0]; exposureUs = told[1]; darkUs = told[2]; pauseUs = told[3]; repeats = told[4]; out = mode[0]; filled = 0;
    Serial.println("ok");
    return;
  }
  if (!strcmp(word, "M")) {
    char *number = strtok(0, " "), *text = strtok(0, " ");
    byte index = number ? atoi(number) : 255;
    if (!text || index >= count || strlen(text) != ROWS * 4) { Serial.println("no such mask"); return; }
    for (byte i = 0; i < ROWS * 2; i++) { char pair[3] = {text[2 * i], text[2 * i + 1], 0}; masks[index][i] = strtoul(pair, 0, 16); }
    filled |= 1UL << index;
    Serial.println("ok");
    return;
  }
  if (!strcmp(word, "A") && loaded() && !running) { armed = true; digitalWrite(SHUTTER, HIGH); Serial.println("ok"); return; }
  if (!strcmp(word, "G") && armed) {
    armed = false; running = true; lit = false; shown = slotsDone = 0; nextUs = micros() + 1000;
    Serial.println("ok");
    return;
  }
  Serial.println("no such line now");
}

void loop() {
  step();
  if (!Serial.available()) return;
  char byte_ = Serial.read();
  if (byte_ == '\n') { line[length] = 0; length = 0; answer(); }
  else if (length < sizeof line - 1) line[length++] = byte_;
}
