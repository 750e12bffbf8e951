"""The camera and the stage that carries it, from pictures of a ChArUco board: the steps `camera` and `stage`."""
