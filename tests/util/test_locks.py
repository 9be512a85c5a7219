"""Folders that one process at a time works in."""

import os

import pytest
from filelock import FileLock

from elitelanes_jax._util import locks
from elitelanes_jax._util.locks import LOCK, locked


def test_an_interruption_while_the_lock_is_taken_leaves_no_folder(tmp_path, monkeypatch):
    class Interrupted(FileLock):
        tries = 0

        def _acquire(self):
            self.tries += 1
            if self.tries == 1:  # the file is there, the lock is not
                os.close(os.open(self.lock_file, os.O_CREAT))
                raise KeyboardInterrupt
            super()._acquire()

    folder = tmp_path / "folder"
    with monkeypatch.context() as patch:
        patch.setattr(locks, "FileLock", Interrupted)
        with pytest.raises(KeyboardInterrupt), locked(folder, folder):
            raise AssertionError("not reached")
    assert not folder.exists()
    with locked(folder, folder):
        assert (folder / LOCK).exists()
