"""A run's parts in the files of other programs: depth maps, a mesh, a film of an orbit, folders of cameras."""
