"""Whether arms still are as their versions say: checks in words, and their history."""
