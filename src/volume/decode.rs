//! Files -> volumes: sniff the format, enforce limits before memory is taken, dispatch.
