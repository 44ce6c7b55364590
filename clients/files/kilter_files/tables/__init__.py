"""What was read: tables in contract columns, and recordings of markers."""
