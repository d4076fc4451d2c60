"""The pressure test: contact pressure and force from the shape of the membrane."""
