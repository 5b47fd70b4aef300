"""Tables into logs (`table`, `mat`, `table_import`) and logs into tables (`export`): CSV, MATLAB, Parquet."""
