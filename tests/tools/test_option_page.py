# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of options agrees with the table of options."""

import option_page


def test_the_page_is_up_to_date():
    text = option_page.PAGE.read_text(encoding="utf-8")
    assert option_page.page(text) == text, "run python tools/option_page.py"
