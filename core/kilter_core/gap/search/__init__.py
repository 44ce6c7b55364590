"""Search for what is missing: the linearised problem, the candidates, their scan, the selection."""
