"""Which fits are made (the other order of depth, a second look, from rest, with motion), and which is chosen."""
