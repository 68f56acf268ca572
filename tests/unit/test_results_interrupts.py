"""Interrupts wait until a block has ended, and are not lost."""

from __future__ import annotations

import os
import signal
import threading
import time

import pytest

from robodyn_cli.results.atomic import uninterrupted

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def test_it_waits() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt):
        with uninterrupted():
            interrupt()
            done.append("block")
        done.append("after")
    assert done == ["block"]
    with pytest.raises(KeyboardInterrupt):
        interrupt()
        time.sleep(0.1)


def test_the_inner_block_hands_it_to_the_outer_one() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        with uninterrupted():
            interrupt()
        done.append("outer")
    assert done == ["outer"]


def test_an_error_of_the_block_goes_on_where_nobody_interrupted() -> None:
    with pytest.raises(ValueError), uninterrupted():
        raise ValueError


def test_other_threads_and_handlers_are_left_alone() -> None:
    found = []

    def work() -> None:
        with uninterrupted():
            found.append(signal.getsignal(signal.SIGINT))

    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [before]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with uninterrupted():
            interrupt()
    finally:
        signal.signal(signal.SIGINT, before)
