"""How large an array in a file may be, checked before memory is allocated for it."""

from typing import Final

LIMIT_BYTES: Final = 4 * 2**30
# Deflate, in .npz, .mat and HDF5 alike, cannot shrink more than 1032:1 (its longest match is 258 bytes, coded in 2
# bits): an array that claims more bytes than this times its file is no array.
DEFLATE_LIMIT: Final = 1032
