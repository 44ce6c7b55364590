"""How good robots are today: one place computes it, and page, HTTP interface, library and command show it."""
