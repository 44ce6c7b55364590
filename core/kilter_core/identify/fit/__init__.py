"""The least-squares fit: problem, solver, priors, weights of rows."""
