"""The ways to find a contact patch that fusion is compared with, behind one interface."""
