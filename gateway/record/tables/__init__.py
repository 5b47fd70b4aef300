"""Import of tables into logs (`table`, `mat`, `table_import`) and export of logs (`export`): CSV, MATLAB, Parquet."""
