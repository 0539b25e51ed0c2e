//! The library's functions, and a program in C over it.

mod library;
mod program;
mod smoke;
