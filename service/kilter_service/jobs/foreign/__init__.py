"""Rows that prove nothing of this arm: what becomes of them once a check has refused them."""
