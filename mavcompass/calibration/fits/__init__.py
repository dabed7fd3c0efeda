"""The solutions of the methods as functions of arrays, with the numbers of their equations."""
