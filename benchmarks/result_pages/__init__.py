"""The pages of docs/results: each module makes the text of one page from the committed rows."""
