//! A thread of another process in an endless loop.

#[cfg(target_arch = "x86_64")]
use testkit::eventually;

#[cfg(target_arch = "x86_64")]
use crate::frozen::Frozen;

/// Puts a thread into an endless loop, without a hook in the daemon: the system call that it sleeps
/// in becomes a jump to itself. False where that is not known for the machine's processor.
#[cfg(not(target_arch = "x86_64"))]
pub fn spin(_thread: i32) -> bool {
    false
}

#[cfg(target_arch = "x86_64")]
pub fn spin(thread: i32) -> bool {
    // On a busy machine it may be found at work.
    eventually("a thread that sleeps", || {
        spins_where_it_sleeps(thread).then_some(())
    });
    true
}

/// Whether the thread was found in a system call, and goes on in an endless loop.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
fn spins_where_it_sleeps(thread: i32) -> bool {
    const SYSCALL: i64 = 0x050f;
    const JUMP_TO_ITSELF: i64 = 0xfeeb;
    let _frozen = Frozen::freeze(thread);
    // SAFETY: numbers alone, all of which may be zero.
    let mut registers: libc::user_regs_struct = unsafe { std::mem::zeroed() };
    // SAFETY: the pointer is to live registers; the address is not looked at.
    let answer = unsafe { libc::ptrace(libc::PTRACE_GETREGS, thread, 0, &mut registers) };
    assert_eq!(answer, 0, "ptrace: {}", std::io::Error::last_os_error());
    // When it goes on, an interrupted sleep is called again.
    let call = registers.rip - 2;
    // SAFETY: an address of the other process, which the kernel checks.
    let word = unsafe { libc::ptrace(libc::PTRACE_PEEKTEXT, thread, call, 0) };
    if word & 0xffff != SYSCALL {
        return false;
    }
    let word = (word & !0xffff) | JUMP_TO_ITSELF;
    // SAFETY: as above; the change is to that process's copy of the page.
    let answer = unsafe { libc::ptrace(libc::PTRACE_POKETEXT, thread, call, word) };
    assert_eq!(answer, 0, "ptrace: {}", std::io::Error::last_os_error());
    true
}
