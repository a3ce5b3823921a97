"""Parts of the documentation that follow from the code; each is a Markdown text, which a directive puts on a page."""
