"""Where a path may come from: tracks, files, matched features, displacements, rest."""
