"""A gap search as a story: where the model is wrong, what explains it, how sure that is, and what to measure next."""
