"""From one coded measurement to views, camera path and Gaussian scene. Never imports drivers or simulators."""
