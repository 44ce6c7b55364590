"""Which effects look alike on these poses, and what tells them apart."""
