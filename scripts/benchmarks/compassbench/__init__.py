"""CompassBench: sealed cases with truth, rivals that solve them, one judge. README.md is its data card."""
