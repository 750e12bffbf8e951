"""Which fits are made (a second look, from rest, with motion), and which is chosen."""
