"""The physical effects. Every file here names its own in `EFFECTS`; nothing else needs to know them."""
