"""The application: document, worker, main window, command line."""
