"""From one coded measurement to views, camera path and Gaussian scene. Imports neither drivers nor simulators."""
