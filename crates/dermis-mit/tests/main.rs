//! Compares magnetic induction with reference values, closed forms and other methods.

mod coils;
mod edge;
mod multipoles;
mod plate;
mod rings;
mod sensitivity;
mod shared;
mod sheet;
