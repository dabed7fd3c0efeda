"""The effects: what the catalogue names, made once more from the physics, and what it does not name."""
