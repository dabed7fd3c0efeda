"""A vehicle's parameters: protocol, values, rules, files, and the write as a transaction with its undo."""
