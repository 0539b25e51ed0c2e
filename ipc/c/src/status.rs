//! What a function came to, as a number.

/// What every function returns but those that cannot fail: 0 done, above 0 nothing went wrong but there is no answer,
/// below 0 an error. `vpc_message()` has the words.
#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Done.
    Ok = 0,
    /// No message is waiting.
    Nothing = 1,
    /// No answer came in time: no controller is at work, or it is not of this domain.
    Timeout = 2,
    /// The controller refused the request; the reply's `outcome` says why.
    Refused = 3,
    /// An argument is NULL or outside its range.
    Argument = -1,
    /// The domain cannot be joined.
    Domain = -2,
    /// The place is taken: another camera is at work in this domain, or as many operators or observers as fit.
    Taken = -3,
    /// A port cannot be opened.
    Open = -4,
    /// A message was not sent.
    Publish = -5,
    /// Nothing can be received.
    Receive = -6,
    /// A message came that breaks the contract, and was thrown away.
    Invalid = -7,
    /// A handle was used in another thread than the one that made it.
    Thread = -8,
    /// A defect of this library. Close the handle; the program may go on.
    Panic = -9,
}
