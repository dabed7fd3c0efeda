"""Lets the tests in the folders below import the helpers that stand here: dialogue, far_ends, serving."""
