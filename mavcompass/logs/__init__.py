"""Readers and writers of recordings; every reader yields a Track."""
