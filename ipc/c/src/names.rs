//! Codes in words.

use std::ffi::{CString, c_char};
use std::fmt::Display;
use std::sync::OnceLock;

use ipc::{Hold, Outcome, SolverStatus, StrategyCode, TwistState};

/// The words of one enumeration, made when they are first asked for.
struct Words(OnceLock<Vec<CString>>);

impl Words {
    const fn new() -> Self {
        Self(OnceLock::new())
    }

    fn of<T: Display>(&self, code: u32, from_code: fn(u32) -> Option<T>) -> *const c_char {
        // Codes count from 0 without gaps; nothing here panics, so no guard is needed.
        let words = self.0.get_or_init(|| {
            (0..)
                .map_while(from_code)
                .filter_map(|value| CString::new(value.to_string()).ok())
                .collect()
        });
        let index = usize::try_from(code).unwrap_or(usize::MAX);
        words.get(index).map_or(c"unknown".as_ptr(), |w| w.as_ptr())
    }
}

/// A vpc_state in words; "unknown" for other numbers. Valid for ever, as those below.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_state_name(code: u32) -> *const c_char {
    static WORDS: Words = Words::new();
    WORDS.of(code, TwistState::from_code)
}

/// A vpc_hold in words.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_hold_name(code: u32) -> *const c_char {
    static WORDS: Words = Words::new();
    WORDS.of(code, Hold::from_code)
}

/// A vpc_outcome in words.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_outcome_name(code: u32) -> *const c_char {
    static WORDS: Words = Words::new();
    WORDS.of(code, Outcome::from_code)
}

/// A vpc_strategy in words.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_strategy_name(code: u32) -> *const c_char {
    static WORDS: Words = Words::new();
    WORDS.of(code, StrategyCode::from_code)
}

/// A vpc_solver in words.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_solver_name(code: u32) -> *const c_char {
    static WORDS: Words = Words::new();
    WORDS.of(code, SolverStatus::from_code)
}
