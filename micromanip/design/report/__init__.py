"""One model of a report, and one renderer: a page of HTML that needs nothing but itself."""
