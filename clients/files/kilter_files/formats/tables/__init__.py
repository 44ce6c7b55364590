"""Tables of a lab as columns by name: text, workbooks, MATLAB, Parquet, TDMS."""
