"""Lets the tests in the folders below import the helpers that stand here: recorded_frames, the builders."""
