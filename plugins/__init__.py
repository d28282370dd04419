"""Built-in opacity estimators, declared in pyproject.toml exactly as a stranger's would be."""
