//! Names of codes.

use std::ffi::c_char;

use messages::{Encoding, Hold, Outcome, SolverStatus, StrategyCode, Table, TwistState};

fn name(table: &Table, code: u32) -> *const c_char {
    table
        .get(code)
        .map_or(c"unknown", |name| name.c_text)
        .as_ptr()
}

/// The name of a vpc_state for people; "unknown" for other numbers. Always valid, as are those
/// below.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_state_name(code: u32) -> *const c_char {
    name(&TwistState::TABLE, code)
}

/// The name of a vpc_hold.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_hold_name(code: u32) -> *const c_char {
    name(&Hold::TABLE, code)
}

/// The name of a vpc_outcome.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_outcome_name(code: u32) -> *const c_char {
    name(&Outcome::TABLE, code)
}

/// The name of a vpc_strategy.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_strategy_name(code: u32) -> *const c_char {
    name(&StrategyCode::TABLE, code)
}

/// The name of a vpc_encoding.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_encoding_name(code: u32) -> *const c_char {
    name(&Encoding::TABLE, code)
}

/// The name of a vpc_solver.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_solver_name(code: u32) -> *const c_char {
    name(&SolverStatus::TABLE, code)
}
