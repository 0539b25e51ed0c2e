//! The law in simulated time, a file for each thing it is asked to do: one executable, because each
//! that holds the law takes as long to build again, and so all tests share the processors.

mod acceleration;
mod blind;
mod crossing;
mod delay;
mod drift;
mod guard;
mod joints;
mod markers;
mod masks;
mod patience;
mod standing;
mod state;
mod subproblem;
mod subproblems;
mod world;
