"""Tables and files that a run wrote."""

import csv


def rows_of(path):
    """A CSV file's rows."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def head_of(path):
    """A CSV file's columns."""
    with path.open(newline="", encoding="utf-8") as file:
        return next(csv.reader(file))


def files_in(folder):
    """The files below a folder, by their relative path."""
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file()
    }


def contents_of(folder, *suffixes):
    """The bytes of all files of some kinds below a folder, by default of all."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and (not suffixes or path.suffix in suffixes)
    }
