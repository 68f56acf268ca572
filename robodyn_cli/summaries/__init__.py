"""What the summaries of commands hold: records whose fields say what each number is, in what unit, with what error."""
