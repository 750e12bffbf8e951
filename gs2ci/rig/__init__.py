"""A rig: its file, its devices or their twins, the patterns laid out on it, and the recording of what it takes."""
