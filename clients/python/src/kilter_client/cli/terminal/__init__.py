"""What commands share: arguments, references, tables, progress bars, errors in terms of what was typed."""
