"""What a request passes before a feature sees it: gate, tokens, roles, limits; and problems, audit, health."""
