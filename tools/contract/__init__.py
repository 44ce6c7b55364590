"""What is written from the contract and from core's effects: `python -m tools.contract`, with --check to compare only."""
