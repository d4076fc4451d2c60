"""Qt widgets that know no application: value(), setValue(), valueChanged."""
