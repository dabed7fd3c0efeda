"""The attitude that a recording tells, and how far it goes: never from the compass under test."""
