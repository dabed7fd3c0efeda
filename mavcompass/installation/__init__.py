"""What this installation has: data files, optional parts, files that were added, and how it is called."""
