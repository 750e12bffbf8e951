"""What is fitted besides: the other order of depth, a second look, from rest, with motion; and which of it is taken."""
