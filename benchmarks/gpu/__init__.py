"""The viewer's own drawing on a graphics processor, with no browser in between."""
