"""What goes wrong with input from outside."""


class InputError(ValueError):
    """A file or an argument is at fault: one line that names the file and the row, column or parameter."""
