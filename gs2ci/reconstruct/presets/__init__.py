"""How far a reconstruction goes: presets by name, the paper's, what can be left out of them, what a budget allows."""
