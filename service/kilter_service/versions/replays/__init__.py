"""Task, rules and answers that are kept with every active version, and their replay."""
