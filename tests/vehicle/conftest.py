"""Lets the tests in the folders below import the helpers that stand here, such as dialogue and far_ends."""
