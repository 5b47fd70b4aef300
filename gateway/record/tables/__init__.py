"""Import of tables into logs (`table`, `table_import`) and export of logs (`export`): CSV, MATLAB, Parquet."""
