"""What a terminal shows and says: a live line with a bar, a dial, prompts spoken aloud."""
