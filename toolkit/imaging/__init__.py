"""Pictures from files: the only place with paths and decoders."""
