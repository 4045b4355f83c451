"""A change of the program in a text that somebody else wrote."""

from hypothesis import given
from hypothesis import strategies as st

from micromanip.settings.write import with_lines_kept

TEXTS = st.lists(st.sampled_from(["a\n", "b\n", "c\n", "\n"]), max_size=8).map("".join)


def test_only_what_was_changed_changes():
    own, before = "a:   1\nb: 2   \n\n# c\nd: 4\n", "a: 1\nb: 2\n# c\nd: 4\n"
    assert with_lines_kept(own, before, before.replace("4", "5")) == own.replace("4", "5")
    assert with_lines_kept(own, before, before.replace("# c\n", "# c\ne: 6\n")) == own.replace("# c\n", "# c\ne: 6\n")
    assert with_lines_kept(own, before, before.replace("d: 4\n", "")) == own.replace("d: 4\n", "")


def test_where_both_differ_it_is_as_the_program_writes_it():
    assert with_lines_kept("a:   1\nd: 4\n", "a: 1\nd: 4\n", "a: 2\nd: 4\n") == "a: 2\nd: 4\n"


@given(TEXTS, TEXTS, TEXTS)
def test_no_change_leaves_it_and_a_text_of_ones_own_becomes_the_new_one(own, before, after):
    assert with_lines_kept(own, before, before) == own
    assert with_lines_kept(before, before, after) == after
