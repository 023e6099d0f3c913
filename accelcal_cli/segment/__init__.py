"""Finding stillness in a stream of chunks."""
