"""Put the answer together: verdict, names, how far the gap closes, where it lies, what to do next."""
