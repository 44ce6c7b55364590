"""Tables of measured rows: bytes of CSV, Parquet and JSON, the meaning of columns, and what core makes of them."""
