"""New machines from templates: a built-in machine with other values, and comments on its file's fields."""
