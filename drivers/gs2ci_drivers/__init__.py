"""Device drivers and the acquisition that ties them. Knows neither torch nor that simulated twins exist."""
