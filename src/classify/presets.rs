//! The transfer functions that ship with the program, by name.
