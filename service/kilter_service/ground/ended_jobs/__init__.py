"""How many jobs have ended, and how long they took: counted when they end, for no purge to change it."""
