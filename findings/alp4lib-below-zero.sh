#!/usr/bin/env bash
# A good guess: alp4lib's DevInquire returns the signed 32-bit number that the ALP library writes, so that the documented
# temperature (1/256 degree, signed) of a board at -1.5 degrees is read as -384.
# Found: on 64-bit Linux alp4lib hands the library a c_long of 64 bits preset to 0 and returns all of it. The library
# writes 32 bits (alp.h: int32_t, as alp4lib's own comment on tAlpLinePut says), so -384 is read as 4294966912, which is
# 16.8 million degrees. Numbers from 0 on are right, so nothing shows it before the laboratory is cold. The library here
# is a stand-in of one function, built by cc.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet alp4lib==1.1.0 six==1.17.0 numpy==2.4.6
cd "$folder"
cat >alp.c <<'C'
#include <stdint.h>
int32_t AlpDevInquire(uint32_t device, int32_t kind, int32_t *value) { *value = kind == 2052 ? -384 : 384; return 0; }
C
cc -shared -fPIC -o libalp43.so alp.c
venv/bin/python - <<'PY'
from importlib.metadata import version

import ALP4

device = ALP4.ALP4(version="4.3", libDir=".")
warm, cold = device.DevInquire(ALP4.ALP_DDC_FPGA_TEMPERATURE), device.DevInquire(ALP4.ALP_PCB_TEMPERATURE)
print("alp4lib", version("alp4lib"), "written 384 and -384, returned", warm, "and", cold)
assert (warm, cold) == (384, 4294966912), "the behaviour has changed"
PY
