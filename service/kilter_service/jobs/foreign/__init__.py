"""Rows of another arm: what becomes of them once a check has refused them."""
