"""Tables of numbers in text and Parquet files: the format of a text, its columns, and paths of points."""
