"""The kit of a low-cost arm: what to do, which views are missing, and one page of what the arm has."""
