"""Moving pictures of a result: frames, and the files that they go into."""
