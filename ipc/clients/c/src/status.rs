//! The result of a function.

/// Result of every function that can fail: 0 done, above 0 no answer but no error either, below 0
/// an error. vpc_message() explains it.
#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Done.
    Ok = 0,
    /// No message is waiting.
    Nothing = 1,
    /// No answer came in time: no controller is at work in this domain.
    Timeout = 2,
    /// The controller refused the request; the reply's `outcome` says why.
    Refused = 3,
    /// An argument is NULL or outside its range.
    Argument = -1,
    /// The domain cannot be joined, or its stop file cannot be used.
    Domain = -2,
    /// Another camera is at work in this domain, or as many operators or observers as the service
    /// allows.
    Taken = -3,
    /// A port cannot be opened.
    Open = -4,
    /// A message was not sent.
    Publish = -5,
    /// Nothing can be received.
    Receive = -6,
    /// A message that breaks the contract came and was dropped.
    Invalid = -7,
    /// A handle was used in another thread than the one that made it.
    Thread = -8,
    /// A defect of this library. Close the handle; the program may go on.
    Panic = -9,
}
