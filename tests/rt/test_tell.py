"""The host's words: what they announce is in memory before them."""

import numpy as np
import pytest

from micromanip.rt.mailbox import WORDS
from micromanip.rt.tell import ask, tell

from .native import llvm_of


def test_a_word_is_written_and_read():
    words = np.zeros(WORDS, np.int64)
    tell(words, 3, -7)
    assert words.tolist() == [0, 0, 0, -7] + [0] * (WORDS - 4)
    assert ask(words, 3) == -7


@pytest.mark.compiled_only
def test_they_are_ordered_on_every_cpu():
    written, read = (llvm_of(function, function.signatures[0]) for function in (tell, ask))
    assert "release, align 8" in written
    assert "load atomic" in read
    assert "acquire, align 8" in read
