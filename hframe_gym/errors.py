"""The exception for invalid files and arguments."""


class InputError(ValueError):
    """A file or an argument is invalid.

    The message is one line that names the file, the row, column or field, and what to do. Commands print it and exit
    with code 2.
    """
