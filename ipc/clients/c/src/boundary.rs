//! The boundary to C: errors become numbers and messages, panics stop here, handles stay in their
//! thread.

use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::thread::ThreadId;

use ipc::{AskError, JoinError, LoanError, OpenError, PublishError, ReceiveError, StopError};
use messages::Invalid;

use crate::status::Status;

thread_local! {
    static MESSAGE: RefCell<CString> = RefCell::new(CString::default());
}

/// Why a function did not do what was asked.
#[derive(Debug)]
pub struct Fault {
    status: Status,
    words: String,
}

impl Fault {
    /// A failure with its message.
    pub fn new(status: Status, words: impl Into<String>) -> Self {
        Self {
            status,
            words: words.into(),
        }
    }

    /// An argument that is NULL.
    pub fn null(argument: &str) -> Self {
        Self::new(
            Status::Argument,
            format!("{argument} = NULL; allowed: a valid pointer"),
        )
    }
}

impl From<Invalid> for Fault {
    fn from(error: Invalid) -> Self {
        Self::new(Status::Argument, error.to_string())
    }
}

impl From<JoinError> for Fault {
    fn from(error: JoinError) -> Self {
        Self::new(Status::Domain, error.to_string())
    }
}

impl From<StopError> for Fault {
    fn from(error: StopError) -> Self {
        let status = match error {
            StopError::File { .. } => Status::Domain,
            StopError::NotObeyed { .. } => Status::Timeout,
        };
        Self::new(status, error.to_string())
    }
}

impl From<OpenError> for Fault {
    fn from(error: OpenError) -> Self {
        let status = match error {
            OpenError::Taken { .. } | OpenError::Full { .. } => Status::Taken,
            _ => Status::Open,
        };
        Self::new(status, error.to_string())
    }
}

impl From<LoanError> for Fault {
    fn from(error: LoanError) -> Self {
        let status = match error {
            LoanError::Header(_) | LoanError::TooLarge { .. } => Status::Argument,
            LoanError::Transport { .. } => Status::Publish,
        };
        Self::new(status, error.to_string())
    }
}

impl From<PublishError> for Fault {
    fn from(error: PublishError) -> Self {
        Self::new(Status::Publish, error.to_string())
    }
}

impl From<ReceiveError> for Fault {
    fn from(error: ReceiveError) -> Self {
        let status = match error {
            ReceiveError::Invalid { .. } => Status::Invalid,
            ReceiveError::Transport { .. } => Status::Receive,
        };
        Self::new(status, error.to_string())
    }
}

impl From<AskError> for Fault {
    fn from(error: AskError) -> Self {
        match error {
            AskError::Publish(error) => error.into(),
            AskError::Receive(error) => error.into(),
        }
    }
}

/// Runs the body of a function of the header: stops panics, and keeps the words of an error for
/// `vpc_message`.
pub fn enter(act: impl FnOnce() -> Result<(), Fault>) -> Status {
    // After a panic nothing is promised of the handle but that it can be closed.
    let fault = match catch_unwind(AssertUnwindSafe(act)) {
        Ok(Ok(())) => return Status::Ok,
        Ok(Err(fault)) => fault,
        Err(panic) => {
            let words = panic.downcast_ref::<String>().map(String::as_str);
            let words = words.or_else(|| panic.downcast_ref::<&str>().copied());
            let words = format!("a defect: {}", words.unwrap_or("no reason given"));
            Fault::new(Status::Panic, words)
        }
    };
    let words = fault.words.replace('\0', "?");
    // A thread that ends has no place for words any more.
    let _ = MESSAGE.try_with(|message| {
        if let Ok(mut message) = message.try_borrow_mut() {
            *message = CString::new(words).unwrap_or_default();
        }
    });
    fault.status
}

/// What the caller holds a pointer to: a value and the thread that made it.
pub struct Handle<T> {
    thread: ThreadId,
    value: T,
}

/// The value behind a pointer to a handle, which is the argument `name`.
///
/// # Safety
/// `handle` is NULL or came from [`give`] and was not closed.
///
/// # Errors
/// NULL, or another thread.
pub unsafe fn handle<'a, T>(handle: *mut Handle<T>, name: &str) -> Result<&'a mut T, Fault> {
    // SAFETY: valid if it is not NULL, by the caller's promise. Only its own thread uses the value;
    // until that is checked, only the thread's id is read, which never changes.
    let thread = unsafe { handle.as_ref() }
        .ok_or_else(|| Fault::null(name))?
        .thread;
    if thread != std::thread::current().id() {
        let words = format!(
            "{name}: used in another thread than the one that made it; allowed: its own, others join for themselves"
        );
        return Err(Fault::new(Status::Thread, words));
    }
    // SAFETY: as above, and this thread is inside one function of this library at a time.
    Ok(unsafe { &mut (*handle).value })
}

/// Gives a new handle to the caller.
///
/// # Safety
/// `place` is NULL or points to writable memory for a pointer.
///
/// # Errors
/// NULL.
pub unsafe fn give<T>(place: *mut *mut Handle<T>, value: T) -> Result<(), Fault> {
    let thread = std::thread::current().id();
    // SAFETY: the caller's promise.
    unsafe {
        put(
            place,
            "out",
            Box::into_raw(Box::new(Handle { thread, value })),
        )
    }
}

/// Closes a handle; NULL is closed already.
///
/// # Safety
/// As [`handle`]; not to be used again.
///
/// # Errors
/// Another thread: it stays open.
pub unsafe fn close<T>(pointer: *mut Handle<T>, name: &str) -> Result<(), Fault> {
    if pointer.is_null() {
        return Ok(());
    }
    // SAFETY: the caller's promise.
    unsafe { handle(pointer, name) }?;
    // SAFETY: it came from `give`, which made it by `Box::into_raw`.
    drop(unsafe { Box::from_raw(pointer) });
    Ok(())
}

/// Writes a value to the caller's place.
///
/// # Safety
/// `place` is NULL or points to writable memory for a value.
///
/// # Errors
/// NULL.
pub unsafe fn put<T>(place: *mut T, argument: &str, value: T) -> Result<(), Fault> {
    if place.is_null() {
        return Err(Fault::null(argument));
    }
    // SAFETY: not NULL, and a place for a value, says the caller.
    unsafe { place.write(value) };
    Ok(())
}

/// Writes a value to the caller's place where there is one.
///
/// # Safety
/// As [`put`].
pub unsafe fn put_if_asked<T>(place: *mut T, value: T) {
    if !place.is_null() {
        // SAFETY: as in `put`.
        unsafe { place.write(value) };
    }
}

/// A copy of the caller's value.
///
/// # Safety
/// `place` is NULL or points to a value.
///
/// # Errors
/// NULL.
pub unsafe fn get<T: Copy>(place: *const T, argument: &str) -> Result<T, Fault> {
    // SAFETY: the caller's promise.
    unsafe { place.as_ref() }
        .copied()
        .ok_or_else(|| Fault::null(argument))
}

/// The caller's words.
///
/// # Safety
/// `text` is NULL or ends in NUL.
pub unsafe fn text<'a>(text: *const c_char) -> Option<&'a CStr> {
    // SAFETY: the caller's promise.
    (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) })
}

/// The last error of this thread in words; empty if there was none. Valid until the next call of
/// this library in this thread.
#[unsafe(no_mangle)]
pub extern "C" fn vpc_message() -> *const c_char {
    let words = MESSAGE.try_with(|message| message.try_borrow().map(|words| words.as_ptr()));
    match words {
        Ok(Ok(words)) => words,
        _ => c"".as_ptr(),
    }
}
