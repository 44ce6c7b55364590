"""The kit of a low-cost arm: whether views are enough, what to do, and what an identification says in plain words."""
