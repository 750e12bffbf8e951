"""Which masks, travel and number of exposures serve a bench and a scene best: candidates, and what they tell."""
