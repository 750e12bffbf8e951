"""Several exposures of one scene."""
