"""The membrane contact test: contact from local means of the difference of both depths."""
