"""The formats of recordings, each a room of its own with its reader and, where there is one, its writer."""
