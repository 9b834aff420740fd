"""Pictures, films, arrays and live cameras as a sequence of frames."""
