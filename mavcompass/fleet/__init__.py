"""Many recordings: found, examined in processes or on a cluster, kept in a journal, told in a table.

`run.run_fleet` is the whole way; everything that happens to one recording is `examine.examine`, a function
of plain values that any process on any machine can run.
"""
