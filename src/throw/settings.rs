//! A macro for structs of settings: the default and the range of each setting stand next to it.

/// A number of any type, or an optional number, so that the macro can check settings of all these types.
pub(crate) trait Number {
    /// The number as `f64`; `None` if it is absent.
    fn number(self) -> Option<f64>;
}

impl Number for f64 {
    fn number(self) -> Option<f64> {
        Some(self)
    }
}

impl Number for u32 {
    fn number(self) -> Option<f64> {
        Some(self.into())
    }
}

impl Number for u64 {
    fn number(self) -> Option<f64> {
        Some(self as f64)
    }
}

impl Number for usize {
    fn number(self) -> Option<f64> {
        Some(self as f64)
    }
}

impl<T: Number> Number for Option<T> {
    fn number(self) -> Option<f64> {
        self.and_then(T::number)
    }
}

/// Defines a struct of settings. Each field has its default after `=`, and may have a [`Range`](super::Range) after a
/// comma. The struct gets `Default`, and the method `check_ranges`, which fails with the first number outside its
/// range.
macro_rules! settings {
    (
        $(#[$attribute:meta])*
        $visibility:vis struct $name:ident {
            $(
                $(#[$field_attribute:meta])*
                $field_visibility:vis $field:ident: $type:ty = $default:expr $(, $range:expr)?;
            )*
        }
    ) => {
        $(#[$attribute])*
        $visibility struct $name {
            $($(#[$field_attribute])* $field_visibility $field: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $name {
            /// Checks the range of each number.
            ///
            /// # Errors
            /// The first number outside its range.
            pub fn check_ranges(&self) -> Result<(), $crate::throw::OutOfRange> {
                $($(
                    if let Some(number) = $crate::throw::Number::number(self.$field) {
                        $crate::throw::Range::check($range, stringify!($field), number)?;
                    }
                )?)*
                Ok(())
            }
        }
    };
}
pub(crate) use settings;
