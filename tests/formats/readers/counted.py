"""What a reader's program shares with the others: it reads the files of its arguments, and prints a line for each."""

import json
import logging
import sys
import warnings

MARK = "READ "
"""The start of a line, because readers print lines of their own."""


class Warned(logging.Handler):
    """Collects what a reader logs and warns of."""

    def __init__(self):
        super().__init__(logging.WARNING)
        self.messages = []
        logging.getLogger().handlers = [self]
        warnings.showwarning = lambda message, *_, **__: self.messages.append(str(message))

    def emit(self, record):
        self.messages.append(record.getMessage())


def main(read):
    """Prints what `read` returns for each file: numbers by their names, and a list of `warnings`."""
    for file in sys.argv[1:]:
        try:
            counts = read(file)
        except Exception as error:
            counts = {"error": f"{type(error).__name__}: {error}"[-400:]}
        print(f"\n{MARK}{json.dumps(counts)}", flush=True)
