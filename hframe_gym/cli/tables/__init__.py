"""Tables that the commands print, by what they are about."""
