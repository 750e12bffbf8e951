"""Camera paths from tracks, files and reports of stages, and what is doubtful about them."""
