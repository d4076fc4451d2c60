"""The membrane contact test: contact where a membrane in equilibrium touches the object."""
