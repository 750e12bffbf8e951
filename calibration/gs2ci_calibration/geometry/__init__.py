"""The camera and the stage that moves it, from pictures of a ChArUco board: the steps `camera` and `stage`."""
