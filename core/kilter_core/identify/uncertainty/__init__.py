"""How far parameters and predictions are known."""
