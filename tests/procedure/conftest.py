"""Lets the tests in the folders below import the helper that stands here: bent_vehicles."""
