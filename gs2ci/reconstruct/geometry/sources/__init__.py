"""Where a path may come from: tracks, files, matched features, displacements, a uniform motion, rest."""
