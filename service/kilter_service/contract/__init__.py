"""The words of the interface: pydantic models of every request and answer, each field with meaning, unit and range."""
