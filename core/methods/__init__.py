"""The methods that find a contact patch, behind one interface: fusion and the methods it is compared with."""
