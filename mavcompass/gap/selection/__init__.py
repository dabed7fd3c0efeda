"""Choose the effects: held-out blocks, search, the criterion, and the choice fitted again on all rows."""
