//! Who is at work in a domain, and how the process before it ended: the rules of the note that a
//! process keeps there. It names the process from its beginning on; what is left of one that was
//! killed is an end that was not clean, until an operator arms. Pure; the daemon keeps the note in
//! a file.

/// A process that has a domain, after what the note said. Processes are named by `P`.
#[derive(Clone, Debug)]
pub struct Presence<P> {
    us: P,
    /// The process that had the domain before, if it ended without giving it back, or one whose
    /// unclean end no operator has known of yet.
    pub unclean: Option<P>,
    /// Whether an operator has armed: an unclean end before is forgotten.
    pub has_consent: bool,
    /// Whether this process begins again: until it has, its end is not clean.
    pub is_followed: bool,
}

/// What a process that ends in order leaves in the note.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Note<P> {
    /// This process, as before.
    Us,
    /// The process whose unclean end nobody knows of yet.
    Before(P),
    /// Nothing.
    Empty,
}

impl<P: PartialEq> Presence<P> {
    /// `us` takes the domain, in which `left` stands.
    pub fn claim(us: P, left: Option<P>) -> Self {
        Self {
            us,
            unclean: left,
            has_consent: false,
            is_followed: false,
        }
    }

    /// After this process has begun again: what it left itself is no unclean end.
    pub fn follow(&mut self) {
        self.unclean.take_if(|process| *process == self.us);
    }

    /// What it leaves when it ends in order.
    pub fn leave(&self) -> Note<&P> {
        let unknown = self.unclean.as_ref().filter(|_| !self.has_consent);
        match unknown {
            Some(process) => Note::Before(process),
            None if self.is_followed => Note::Us,
            None => Note::Empty,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unclean_end_is_told_until_an_operator_has_armed() {
        let first = Presence::claim(1, None);
        assert_eq!((first.unclean, first.leave()), (None, Note::Empty));
        // It was killed; the next one ends without an operator, also in order to begin again.
        let mut next = Presence::claim(2, Some(1));
        for is_followed in [false, true] {
            next.is_followed = is_followed;
            assert_eq!((next.unclean, next.leave()), (Some(1), Note::Before(&1)));
        }
        next.has_consent = true;
        assert_eq!(next.leave(), Note::Us);
        next.is_followed = false;
        assert_eq!(next.leave(), Note::Empty);
    }

    #[test]
    fn what_a_process_left_itself_is_no_unclean_end() {
        let mut again = Presence::claim(1, Some(1));
        again.follow();
        assert_eq!(again.unclean, None);
        let mut other = Presence::claim(1, Some(2));
        other.follow();
        assert_eq!(other.unclean, Some(2));
    }
}
